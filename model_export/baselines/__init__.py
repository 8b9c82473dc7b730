"""Every method that the paper compares or discusses, behind one interface (``method.Method``)."""
