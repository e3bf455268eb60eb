/* What the build of BLASFEO writes: here the flags of the recipe say it. */
