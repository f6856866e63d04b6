"""The paper's figures of one trained run: `python -m pipeline.figures RUN`."""
