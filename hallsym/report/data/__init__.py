"""What figures and pages show, reduced from a log of any length: typed records that know no renderer."""
