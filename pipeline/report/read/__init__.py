"""What the report knows before it has read a run: the paper's tables, scenes and ablations."""
