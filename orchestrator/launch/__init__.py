"""A network of processes: started, supervised, recorded, controlled."""
