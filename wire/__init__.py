"""How processes talk: key expressions, the message codec, Zenoh sessions, and the line that ends a child with its parent."""
