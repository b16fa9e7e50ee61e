"""Named weights shipped with the package."""
