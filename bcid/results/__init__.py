"""What runs find, as typed records: the JSON files of run folders, format/2."""
