"""Pictures and files for people, made from run folders alone: nothing here solves anything."""
