"""From segments to scored lines: chaining, bridging, and what a line is worth."""
