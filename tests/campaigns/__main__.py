"""Campaigns that try for minutes or hours what no test can list; nothing runs them but a person.

    python -m tests.campaigns commands --minutes 10 --keep DIR   # words, and damaged files
    python -m tests.campaigns interruptions --moments 50         # kills, full disks, permissions
    python -m tests.campaigns robot --minutes 5                  # configurations, logs, streams

Each takes --seed and --help, names what it found, and exits with 1 if that was anything.
"""

import importlib
import sys
import tempfile
from pathlib import Path

CAMPAIGNS = ("commands", "interruptions", "robot")

if __name__ == "__main__":
    name, *options = sys.argv[1:] or ["--help"]
    if name not in CAMPAIGNS:
        print(__doc__)
        sys.exit(0 if name in ("-h", "--help") else f"expected one of {CAMPAIGNS}, got {name!r}")
    with tempfile.TemporaryDirectory() as folder:
        found = importlib.import_module(f"tests.campaigns.{name}").main(options, Path(folder))
    sys.exit(found.report())
