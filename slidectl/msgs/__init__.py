"""Message, service and action definitions as data, and the one module that builds, checks and defaults them."""
