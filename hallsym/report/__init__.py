"""What a person reads: words, figures and pages, all drawn from the same typed results."""
