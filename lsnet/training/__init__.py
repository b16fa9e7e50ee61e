"""Training: from samples to checkpoints."""
