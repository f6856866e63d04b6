"""Groups learning curves into figures and averages them over seeds."""
