"""The processes that compute, and the pools that the service keeps of them."""
