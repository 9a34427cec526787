"""What a notebook shows of things, as HTML."""
