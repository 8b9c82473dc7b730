"""Clients' sockets: how many, how fast they are read, how long they may take, how they close."""
