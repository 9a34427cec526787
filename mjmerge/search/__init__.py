"""What to run next: ladders and breaking points."""
