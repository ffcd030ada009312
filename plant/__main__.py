from hedgerow.plant.command import main

main()
