"""`python -m vergence` is the command line."""

from vergence.cli import main

main()
