"""What the sensors of one batch have in common, and what that says about the next one."""
