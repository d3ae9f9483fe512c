"""Hand-written filters."""
