"""How good a model is: metrics, speed, pictures and videos of held-out views."""
