"""What a run is told: the schema of its settings, how they are composed, and the random streams of its seed."""
