"""Reads finished run folders into data frames and labels each run by its trained model and its settings."""
