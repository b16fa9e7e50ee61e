"""Rules that report what is odd in a flight."""
