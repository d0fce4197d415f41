"""A station checked: instruments, reference ring, golden sensor."""
