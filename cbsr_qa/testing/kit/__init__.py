"""Packages of plugins: made from templates, and checked whether installed or not."""
