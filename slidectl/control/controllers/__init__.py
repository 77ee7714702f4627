"""control/controllers"""
