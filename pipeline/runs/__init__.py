"""The run folder: what a run writes, whose run a folder holds, what it was made with."""
