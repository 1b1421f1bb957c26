/// A library that is no plug-in.
extern "C" __attribute__((visibility("default"))) int palpate_no_plugin() {
  return 0;
}
