"""``python -m mjmerge``."""

from mjmerge.cli import main

main()
