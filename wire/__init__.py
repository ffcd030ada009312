"""How processes talk: key expressions, the message codec, Zenoh sessions, and how a process begins and ends."""
