"""Short trainings of several networks on the same drawn images."""
