"""Analysis of an unannotated recording: channels, noise, presses."""
