"""The exploration study: how many pulls does it take to know how a body is held?"""
