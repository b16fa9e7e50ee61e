"""One file per command group: options, one call, print."""
