"""The communication of the processes: key expressions, the message codec, Zenoh sessions, and process start and end."""
