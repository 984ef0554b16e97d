"""`contramap benchmark grasps`: do grasps planned on reconstructed shapes hold in physics?"""
