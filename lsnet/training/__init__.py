"""Training of the network: samples in, checkpoints out."""
