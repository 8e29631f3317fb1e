"""Facts that images prove when the driver's reports prove nothing."""
