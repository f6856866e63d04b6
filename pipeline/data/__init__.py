"""What a run reads: the scene in canonical coordinates, points from structure from motion, views as training takes them."""
