"""The run folder: written, read, exported, listed; and the in-process reference."""
