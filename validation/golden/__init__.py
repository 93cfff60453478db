"""Golden cases: sixty measurements whose answers are frozen, so that every later change is compared with them, case by case."""
