"""Networks in controllers: their inputs, the bundles that hold them, and the runtime."""
