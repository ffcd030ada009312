"""Networks of processes: start, supervision, recording, control."""
