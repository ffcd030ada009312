from hedgerow.plant.process import main

main()
