"""The 6-DOF precision stage read by three or more Hall probes: models and effects."""
