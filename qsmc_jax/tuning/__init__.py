"""Gains chosen by gradients through the simulation, and what certifies them."""
