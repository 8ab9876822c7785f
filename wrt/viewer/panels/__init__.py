"""The parts of the control panel."""
