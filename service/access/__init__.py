"""API keys: whose they are, what they allow, what they have used."""
