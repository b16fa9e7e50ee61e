"""What leaves the program: SQL, protobuf, JSON schemas and viewer layouts."""
