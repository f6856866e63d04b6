"""Exposure and white balance of several cameras, made equal by the points that they see in common."""
