from hypothesis import settings

# The first call of a compiled loop takes seconds; a deadline would call that a failure.
settings.register_profile("compiled", deadline=None)
settings.load_profile("compiled")
