"""What lies beyond the catalogue: laws and boundary effects that are hidden, and what is proposed for them."""
