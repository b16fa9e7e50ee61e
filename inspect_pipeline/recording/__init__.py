"""Reading and writing of MCAP recordings."""
