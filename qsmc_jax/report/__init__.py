"""Results as tables and files. The one place that touches disk."""
