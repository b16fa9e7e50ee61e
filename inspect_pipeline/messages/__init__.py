"""Parsers and encoders of single messages: images, poses, calibrations."""
