"""The loop in continuous time, in the funnel coordinate."""
