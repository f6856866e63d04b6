"""How well a model shows what moves: error in moving pixels, of its optical flow and of its depth."""
