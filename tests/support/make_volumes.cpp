/// Writes the volumes of writeTestVolumes() into a folder: palpate_make_volumes FOLDER.
#include "tests/support/vdb_files.h"

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  palpate::test::writeTestVolumes(argv[1]);
}
