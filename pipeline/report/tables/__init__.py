"""The tables of the report, one module per kind of table."""
