"""What OpenAPI says beyond the types of the endpoints."""
