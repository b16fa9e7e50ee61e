"""Physically based renders of conductors with Mitsuba 3 (extra `synth`)."""
