"""Networks, their tasks and losses, and the loop that trains them."""
