#include "palpate/scenes/apps/import/reader.h"

#include <utility>

namespace palpate::importer {
namespace {

class OneStep final : public Reader {
 public:
  OneStep(Request request, Content (*how)(const Request&))
      : request_(std::move(request)), read_(how) {}

  Content read(std::size_t /*step*/) override { return read_(request_); }

 private:
  Request request_;
  Content (*read_)(const Request&);
};

}  // namespace

Slab slicesToRead(const Request& request, Piece& image) {
  if (request.slices) image.held = request.slices(image.size, image.file_from_index);
  return image.slices();
}

std::unique_ptr<Reader> oneStep(const Request& request, Content (*read)(const Request&)) {
  return std::make_unique<OneStep>(request, read);
}

}  // namespace palpate::importer
