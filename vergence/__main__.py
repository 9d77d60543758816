"""Run the command line by `python -m vergence`."""

from vergence.cli import main

main()
