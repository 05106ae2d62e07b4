"""Family `interval`."""
