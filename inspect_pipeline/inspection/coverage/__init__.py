"""How much was seen, in four definitions."""
