"""The DuckDB index, made from the flights of a store."""
