"""Hypothesis without a clock and with the same examples in every run."""

from hypothesis import settings

settings.register_profile("hallsym", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("hallsym")
