"""The display of a run in the Rerun viewer, live and afterwards."""
