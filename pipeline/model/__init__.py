"""What is trained: the Gaussians' parameters, how they are initialised, what stands behind them, and how all of it is rendered."""
