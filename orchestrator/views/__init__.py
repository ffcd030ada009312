"""A run on a terminal and in Rerun."""
