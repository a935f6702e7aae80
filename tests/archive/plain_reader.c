/* Prints what files of results hold, with libhdf5 alone, as schemas/archive.md and schemas/block.md describe them:
   format, title, status and verdict, paths and units of all arrays, and the largest force of each joint. */
#define H5_USE_18_API
#include <hdf5.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* A string attribute, which the caller frees with H5free_memory; NULL if there is none. */
static char *text_of(hid_t object, const char *name)
{
    char *text = NULL;
    if (H5Aexists(object, name) <= 0)
        return NULL;
    hid_t attribute = H5Aopen(object, name, H5P_DEFAULT), type = H5Aget_type(attribute);
    if (H5Tis_variable_str(type) > 0)
        H5Aread(attribute, type, &text);
    H5Tclose(type);
    H5Aclose(attribute);
    return text;
}

static void print_text(hid_t object, const char *name)
{
    char *text = text_of(object, name);
    printf("%s\t%s\n", name, text ? text : "-");
    H5free_memory(text);
}

static hsize_t size_of(hid_t set)
{
    hid_t space = H5Dget_space(set);
    hsize_t size = (hsize_t)H5Sget_simple_extent_npoints(space);
    H5Sclose(space);
    return size;
}

static char **names_of(hid_t set)
{
    hid_t type = H5Dget_type(set);
    char **names = calloc(size_of(set) + 1, sizeof *names);
    H5Dread(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, names);
    H5Tclose(type);
    return names;
}

static herr_t print_array(hid_t root, const char *path, const H5O_info_t *info, void *unused)
{
    (void)unused;
    if (info->type != H5O_TYPE_DATASET)
        return 0;
    hid_t set = H5Dopen2(root, path, H5P_DEFAULT);
    char *units = text_of(set, "units");
    printf("array\t%s\t%s\n", path, units ? units : "-");
    H5free_memory(units);
    H5Dclose(set);
    return 0;
}

static void print_forces(hid_t file)
{
    if (H5Lexists(file, "joints", H5P_DEFAULT) <= 0 || H5Lexists(file, "joints/reaction_force", H5P_DEFAULT) <= 0)
        return;
    hid_t joint = H5Dopen2(file, "joints/joint", H5P_DEFAULT), set = H5Dopen2(file, "joints/reaction_force", H5P_DEFAULT);
    hsize_t joints = size_of(joint), rows = joints ? size_of(set) / (2 * joints) : 0; /* rows of all runs of a block */
    char **names = names_of(joint);
    double *force = malloc((2 * joints * rows + 1) * sizeof *force);
    H5Dread(set, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, force);
    for (hsize_t j = 0; j < joints; j++) {
        double largest = NAN;
        for (hsize_t i = 0; i < rows; i++) /* fmax leaves out nan */
            largest = fmax(largest, hypot(force[2 * (i * joints + j)], force[2 * (i * joints + j) + 1]));
        printf("force\t%s\t%.17g\n", names[j], largest);
        H5free_memory(names[j]);
    }
    free(force);
    free(names);
    H5Dclose(set);
    H5Dclose(joint);
}

int main(int count, char **words)
{
    for (int i = 1; i < count; i++) {
        hid_t file = H5Fopen(words[i], H5F_ACC_RDONLY, H5P_DEFAULT);
        if (file < 0)
            return 2;
        char *version = text_of(file, "format_version");
        if (!version || strncmp(version, "1.", 2)) {
            fprintf(stderr, "%s is not in version 1 of its format\n", words[i]);
            return 2;
        }
        H5free_memory(version);
        for (const char **name = (const char *[]){"format", "title", "status", "verdict", NULL}; *name; name++)
            print_text(file, *name);
        H5Ovisit(file, H5_INDEX_NAME, H5_ITER_INC, print_array, NULL);
        print_forces(file);
        H5Fclose(file);
    }
    return 0;
}
