"""What a car believes of itself: data sheet, bicycle, actuation, delays."""
