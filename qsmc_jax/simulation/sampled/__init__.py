"""The loop with an implementation, from event to event."""
