"""A run in the Rerun viewer, live and afterwards."""
