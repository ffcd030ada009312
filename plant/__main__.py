from plant.process import main

main()
