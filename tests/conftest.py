"""What every test runs under: one thread a process, no window, reproducible examples in CI."""

import os

# Set before NumPy or torch is imported, here and in the workers that inherit it: the workers share
# the cores already, and more threads would only take them from one another.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")

from hypothesis import settings

# No deadline: the first example of a property may compile a kernel.
settings.register_profile("vergence", deadline=None, derandomize=bool(os.environ.get("CI")))
settings.load_profile("vergence")
