"""The checks before every run, and what they rest on: releases of files."""
