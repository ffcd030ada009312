"""How long an example may take says nothing on a busy machine: no deadline, unless a test is about time."""

from hypothesis import settings

settings.register_profile("hedgerow", deadline=None, max_examples=50, print_blob=True)
settings.load_profile("hedgerow")
