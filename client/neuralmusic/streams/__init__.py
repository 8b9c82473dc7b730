"""Streams that reconnect, for programs with asyncio and without."""
