"""What the controller is: the sliding surface, the funnel, and the law."""
