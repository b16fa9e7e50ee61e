"""Reports of flights and of stores: one self-contained page each."""
