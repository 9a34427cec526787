"""Whether a car model is what the plant takes it to be."""
