"""Networks of independent controllers that talk only to their neighbours, each its own process, over Zenoh."""
