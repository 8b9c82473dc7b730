"""Networks, what they learn, and the loop that trains them."""
