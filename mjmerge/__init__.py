"""mjmerge."""
