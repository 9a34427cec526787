"""What `mjmerge new` starts from."""
