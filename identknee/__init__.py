"""How far can a knee ligament calibration be trusted?"""
