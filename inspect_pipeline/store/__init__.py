"""The store: a folder of flights, each written whole or not at all."""
