"""The run folder: writing, reading, export, listing; and the in-process reference."""
