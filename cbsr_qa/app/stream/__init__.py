"""Forces as a live stream: from an instrument that takes frames to programs that need newtons."""
