"""What all tests share."""

from hypothesis import settings

settings.register_profile("skyfolio", deadline=None)  # a shared machine may be slow; time is measured in benchmarks
settings.load_profile("skyfolio")
