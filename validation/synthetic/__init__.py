"""The hidden study: does a diagnosis find what was hidden in a measurement?"""
