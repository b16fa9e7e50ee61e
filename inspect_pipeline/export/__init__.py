"""Results in the forms of other programs: viewers, maps, spreadsheets, inspection systems, training."""
