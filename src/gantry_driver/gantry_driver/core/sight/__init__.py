"""What images prove where the driver's reports prove nothing."""
