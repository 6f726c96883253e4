"""How a controller meets reality: sampled, delayed, limited, noisy, and through an actuator."""
