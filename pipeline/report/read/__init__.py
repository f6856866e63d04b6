"""Reference data of the report: the paper's numbers, its scenes and ablations, its evaluation split."""
