"""What a model learnt by heart and what it understood: training views against held-out ones, and how long Gaussians live."""
