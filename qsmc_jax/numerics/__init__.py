"""Numerical methods that know no control loop."""
